"""What the signal meets on its way: each medium gives the delay of a leg, its partials, and why it has none."""
