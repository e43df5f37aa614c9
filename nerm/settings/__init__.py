"""What each stage of NeRM can be told, as frozen values without torch."""
