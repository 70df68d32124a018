"""Screen and camera as plain data: the five parts of a scene, their checked fields, presets."""
