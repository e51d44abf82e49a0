"""The bench: what speaks to a co-processor on the desk, and the procedures that measure it."""

# The guided procedures: verb, and what it does in a line. The module `echowing.rig.<verb>` (a dash
# in the verb is an underscore there) has `add_arguments(parser)` and `run(args) -> exit code`.
PROCEDURES: dict[str, str] = {}
