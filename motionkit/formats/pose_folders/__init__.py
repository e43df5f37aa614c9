"""Folders of pose vectors as HumanML3D and KIT-ML publish them."""
