"""Speed and accuracy figures: each a ratio to a peer, or an error against a reference."""
