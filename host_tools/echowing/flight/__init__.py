"""The flight core: from what is known of the vehicles to what each follower is told. Pure."""
