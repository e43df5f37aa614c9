"""Motion at any instant: motion fields, what makes them of observed frames, and what is done with them."""
