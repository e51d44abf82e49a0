"""Setting a vehicle up: what has to be set on it, checked, changed and put back."""
