"""Run trials: the control loop of one trial, and batches of trials on one or many machines."""
