"""Setting up a vehicle: check what must be set, write it, and restore the old values."""
