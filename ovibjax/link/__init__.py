"""The wireless uplink: request packets, latency, the block-fading channel, measured throughput traces."""
