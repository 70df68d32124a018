"""The physical steps between a screen and a photo, one module each: a verdict on a scene, and a
function of light."""
