"""The learned evaluator at native framerates: network, training, features."""
