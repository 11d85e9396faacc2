"""Studies on the twin and on published data: experiments, published procedures, comparisons."""
