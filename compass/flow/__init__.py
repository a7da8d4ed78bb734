"""How far a strip has moved as a whole: correlation of rows, coarse and to the Cramer-Rao bound."""
