"""Simulated flights: what is flown, by what vehicles, in what world; each part has its room."""
