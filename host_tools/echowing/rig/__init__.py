"""The bench: what speaks to a co-processor on the desk, and the procedures that measure it.

Verbs of `echowing rig`, and what each does in a line. The module `echowing.rig.<verb>` (a dash in
the verb is an underscore there) has `add_arguments(parser)` and `run(args) -> exit code`; `args`
has `port`, `baud` and `json` from the command line.
"""

BOARD_VERBS = {
    "info": "version, board and parameters",
    "watch": "live view: range, state, gimbal, rates, errors",
    "params": "get, set, save, load or compare the board's parameters",
    "aim": "point the gimbal and hold it there",
    "scan": "let the gimbal search, look straight ahead, or decide for itself",
    "self-test": "have the board test its servos, sonar, memory and ports",
    "record": "keep every byte the board sends, with its time, in a file",
    "replay": "show a recording as it was",
}

# The guided procedures.
PROCEDURES = {
    "range-test": "how far the sonar detects a target, how often, how exactly (Table 5)",
    "response-matrix": "the speed answers the range, the applet in the loop (Table 6)",
    "scan-test": "the search's twelve points, their dwell and what they cover (Figure 17)",
    "latency-test": "command to acknowledgement, reading to report",
    "soak": "hours of it: everything that comes, and does not, is counted",
}
