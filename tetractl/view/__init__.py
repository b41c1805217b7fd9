"""What people look at: the terminal's arena, progress, figures."""
