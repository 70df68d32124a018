"""Lightning's trainer, its checkpoints and its processes."""
