"""The stage `detail`: a model of captured motion above 10 Hz, learnt from a store's takes."""
