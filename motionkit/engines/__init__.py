"""A map over many inputs by workers: processes of this machine, or a Ray cluster."""
