"""Feature sets: unit-norm view features with poses, their files, their per-view principal basis."""
