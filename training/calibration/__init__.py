"""A scene held against real photos: pairs and their crops, comparison, fit and report."""
