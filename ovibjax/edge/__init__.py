"""The edge server: retrieval, position estimate and error metrics."""
