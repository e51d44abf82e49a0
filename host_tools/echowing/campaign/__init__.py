"""Thousands of drawn flights with faults, and what any of them found."""
