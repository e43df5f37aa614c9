"""`motionkit complete`: complete clips of any format by an encoder, and write them in that format
(docs/complete.md)."""
