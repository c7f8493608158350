"""Edge scheduling: which waiting request is served next."""
