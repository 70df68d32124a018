"""The images: data sets by name, split, augmented and in batches."""
