"""One or a few episodes: their poses, pictures of them, and a page that plays them."""
