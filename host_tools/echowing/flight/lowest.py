"""How low a follower is flown, for ground tool and applets alike."""

# Above its own home, however much lower the leader's home lies. Nothing leads a follower lower, and
# nothing is sent to one that is lower: there a pilot takes off or lands, and what the sonar hears
# is the ground. The applets fly back by themselves down to half a metre less, because a barometer
# wanders by that much (`LOWEST_M` in lua/*.lua, the same to the digit).
LOWEST_M = 2.0
