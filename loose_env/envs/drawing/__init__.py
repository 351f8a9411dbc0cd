"""Parts of the picture: the arm, the loop on its tool, and the words about them."""
