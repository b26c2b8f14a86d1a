"""The same on a graphics processor, and the thesis's sweep."""
