"""General tools for results: claims, figure style, the results page."""
