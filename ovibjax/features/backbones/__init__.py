"""Image backbones Φ by name: the embedded convolution pyramid, CLIP, any network saved as ONNX."""
