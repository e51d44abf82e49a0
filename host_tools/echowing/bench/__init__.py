"""Figures of `echowing bench` and `echowing calibrate`: how well, how quick, how true to life."""
