"""What the commands of `sagoma calibrate` share: reading footage of boards, live and from files."""
