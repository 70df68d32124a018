"""The camera as a reference: every effect in plain PyTorch, in the order of the light."""
