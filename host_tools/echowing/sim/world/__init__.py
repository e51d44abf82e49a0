"""What a simulated flight happens in: wind, receivers, radios, sonars, leaders and pilots."""
