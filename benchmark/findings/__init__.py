"""What runs show besides their boards: the ladder to reality, time, two touches, new skins."""
