"""Makes everything in `hw/` that is made: wiring, budget, bill of materials, mount and coverage."""
