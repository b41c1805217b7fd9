"""Write the log of a trial to an MCAP file while the trial runs."""
