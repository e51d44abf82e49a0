"""The bench: talks to a co-processor on the desk, and measures it with guided procedures.

The verbs of `echowing rig`, with a line on each. The module `echowing.rig.<verb>` (a dash in
the verb is an underscore there) has `add_arguments(parser)` and `run(args) -> exit code`; `args`
has `port`, `baud` and `json` from the command line.
"""

BOARD_VERBS = {
    "info": "show version, board and parameters",
    "watch": "watch range, state, gimbal, rates and errors live",
    "params": "get, set, save, load or compare the board's parameters",
    "aim": "point the gimbal and hold it there",
    "scan": "let the gimbal search, look straight ahead, or do as in flight",
    "self-test": "have the board test its servos, sonar, memory and ports",
    "record": "write every byte from the board to a file, with its time",
    "replay": "show a recording at the speed of the bench",
}

# The guided procedures.
PROCEDURES = {
    "range-test": "measure how far, how often and how exactly the sonar detects a target (Table 5)",
    "response-matrix": "measure what the sonar hears by range, angle and throttle, write its sonar "
    "file, and say whether it carries a slot",
    "law-test": "check the speed for each range, with the applet in the loop (Table 6)",
    "scan-test": "measure the search: its twelve points, their dwell and their coverage "
    "(Figure 17)",
    "latency-test": "measure the time from command to acknowledgement and from reading to report",
    "axis-test": "check that the gimbal looks where it is ordered to, by echoes, too, and stays "
    "there while the vehicle is turned by hand",
    "soak": "watch the board for hours and count every message, gap and fault",
}
