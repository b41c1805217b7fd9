"""What is known of the cells in a film, as tables and files."""
