"""Tables that map families of skeletons to the standard layouts (data; see `mapping`)."""
