"""What tests share that need tetractl-emulator."""
