"""From image files of somebody else to features: sources, decoding, resumable extraction, image codecs."""
