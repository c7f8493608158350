"""How programs run on this machine: caches, threads, progress, precision of products, cuts between loops."""
