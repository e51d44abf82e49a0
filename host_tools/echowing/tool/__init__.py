"""What runs `follow` and `leader`: the loop, what it shows, logs and publishes."""
