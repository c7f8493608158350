"""The edge server: localizer, retrieval over scenes and tiles, view fusion, and how a code is judged."""
