"""What makes the pages and pictures that show this project: each is run as a module."""
