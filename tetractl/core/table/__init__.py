"""Tables, and the one place that writes them: to read (show), and as data (files, data)."""
