"""Laws u(r), their truncation and mixing, bonded terms, and the plain loops that apply them."""
