"""Monte-Carlo comparison of the schemes, and the paper's figures."""
