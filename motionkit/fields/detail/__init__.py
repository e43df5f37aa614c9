"""What a smooth motion lacks above 10 Hz, drawn from what captures hold there: a motion field on a motion field."""
