"""Published continuous-time methods as 1-D temporal networks, trained as PA-HiRes is: same windows, loss and loop.

Image super-resolution applied to time: LIIF, Meta-SR, A-LIIF, LMF. In-betweening: Δ-Interp, TS-Former.
"""
