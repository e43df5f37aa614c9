"""PA-HiRes's tables and figures."""
