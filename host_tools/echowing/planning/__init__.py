"""Places for a formation that has no name, and whom each of its sonars watches."""
