"""The embedded data, rendered by this project: towns to drive through and rooms of a motion-capture experiment."""
