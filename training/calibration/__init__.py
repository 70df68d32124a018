"""A scene compared with real photos: pairs and their crops, comparison, fit and report."""
