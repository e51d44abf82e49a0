"""The live page: a flight in the browser, as it is flown or from its logs. It commands nothing."""
