"""MAVLink: links, who is who on them, signing, and the messages as this product uses them."""
