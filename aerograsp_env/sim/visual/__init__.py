"""Scenes to look at: tools and everyday things of varied shapes and looks, and what is true of pictures of them.

Everything is made from numbers by this package and seeded; nothing is read from photographs.
"""

from __future__ import annotations

CLASSES = ("screwdriver", "wrench", "pliers", "hammer", "crawler", "can", "juice_box", "box", "fruit")
