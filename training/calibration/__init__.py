"""A scene compared with real photos: crops, comparison, fit and report."""
