"""The wireless link: request packets and latency."""
