"""The embedded rooms: furniture and lamps, drives, a ray-caster, and their frames as features."""
