"""The co-processor in a simulation: its core on this machine, and its boards in an emulator."""
