"""The embedded town: its layout, drives through it, a ray-caster, and its frames as features and files."""
