"""Windows of observed frames and networks that continue them, shared by all models of this kind."""
