"""The figures and claims of published papers, run again and printed next to ours."""
