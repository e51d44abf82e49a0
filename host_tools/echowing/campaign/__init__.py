"""Thousands of random flights with faults, and what they found."""
