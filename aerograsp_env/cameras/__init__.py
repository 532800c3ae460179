"""Cameras that can be exchanged for each other, and images from files."""
