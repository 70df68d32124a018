"""Settings: declared once, composed by Hydra, checked before any time is spent."""
