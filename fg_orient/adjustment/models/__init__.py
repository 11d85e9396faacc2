"""Image models: what the adjustment needs to know about the images of one kind of sensor."""
