"""glTF: an animated skeleton with a visible body, in a .glb container."""
