"""Request control: what a client believes, when it asks the edge, and with which views and prefix."""
