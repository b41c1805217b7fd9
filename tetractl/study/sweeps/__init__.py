"""The kinds of sweep: which values the fields of a spec take, arm by arm."""
