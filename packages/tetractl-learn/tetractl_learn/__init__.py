"""Learnt policies: trials as Gymnasium environments, and a controller that uses a policy."""
