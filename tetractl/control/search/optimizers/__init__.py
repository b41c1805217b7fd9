"""The optimisers that search for a plan.

Each has a file with its fields of the spec and its search.
"""
