"""Training against the moiré: data, models, recipes and the report."""
