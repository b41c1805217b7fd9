"""What tests share that need tetractl-microscope."""
