"""What people are shown of an episode: its moments, and pictures of them."""
