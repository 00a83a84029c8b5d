"""Monte-Carlo comparison of schemes and the paper's figures."""
