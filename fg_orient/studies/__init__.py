"""Studies with synthetic blocks and published data: experiments, published procedures and comparisons."""
