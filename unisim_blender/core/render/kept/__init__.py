"""What of a standing sensor's last frame is kept, because nothing that moved can be seen there."""
