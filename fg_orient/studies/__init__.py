"""Studies on synthetic blocks and published data: experiments, published procedures, comparisons."""
