# The hardware room's part of the Makefile; included by the one at the root.
# Needs on the system: graphviz, openscad, xvfb, xauth, fonts-liberation; in Python: echowing[hw].

.PHONY: hw

hw: setup-test ## draw wiring, mount and coverage, write budget and bill of materials
	@PYTHONPATH=hw $(BIN)/python -m hwtools
