"""Published continuous-time methods as 1-D temporal networks, trained like PA-HiRes: same windows, loss and loop.

Super-resolution of images, turned to time: LIIF, Meta-SR, A-LIIF, LMF. In-betweening: Δ-Interp, TS-Former.
"""
