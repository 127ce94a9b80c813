"""What the window shows of no feature alone: progress in the status bar."""
