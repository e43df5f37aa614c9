"""`motionkit complete`: clips of any format completed by an encoder and written as they came (docs/complete.md)."""
