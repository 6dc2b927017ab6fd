"""Cases where methods of coarse-graining fail: the naive method, and xcg."""
