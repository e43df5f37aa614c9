"""Out of a store again: one file per kind of output, a catalogue, and the folder that appears whole or not at all."""
