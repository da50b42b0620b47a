"""The parking lot drawn: cars, ground and surroundings, light, and a camera to see them with."""
