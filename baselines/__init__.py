"""The analytic pipeline: algorithms on arrays, and the policies made from them.

It may import `aerograsp_env`, never `agents` or a deep-learning framework.
"""
