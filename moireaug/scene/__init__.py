"""What stands in front of the camera, as plain data: five parts, their checked fields, presets."""
