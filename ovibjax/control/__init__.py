"""When and how a client asks the edge: belief, value of information, request policies, route replay."""
