"""Recognisers of actions: fitted here, or published with weights of the user's."""
