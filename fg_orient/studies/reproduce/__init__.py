"""Published beside reproduced: the only package that sees both."""
