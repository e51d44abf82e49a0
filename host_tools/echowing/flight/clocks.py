"""How long the core waits, believes and keeps silent: one figure for each, wherever it is asked.

Times are by the tool's own clock: since the last message of its kind, or between two. Pure.
"""

# Sonar readings come several times a second, over a radio that may lose some, and are used a second
# late: who has not been heard for so long is not in the sonar now, and no readings at all are a
# sonar, or a link, that is silent.
LOST_S = 3.0
# After two missed heartbeats, one a second, the mode is not known any more. A radio that holds
# reports back for so long is as good as silent.
UNHEARD_S = 2.0
# A clock this far behind has restarted, or is another vehicle's: no radio holds a report back for
# so long.
REBOOT_S = 10.0
# Two reports of one vehicle further apart do not show its acceleration: it may have turned unseen.
LONGEST_GAP_S = 0.6
# A slow radio answers within a second, and loses one answer in three at its worst.
ASK_PERIOD_S = 1.0
# The same text is not repeated sooner, however often the state comes and goes: nobody has to act on
# it at once.
SAY_AGAIN_S = 30.0
