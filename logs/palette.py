"""Colours of several flights in one picture: report and viewer show a member in the same colour."""

# Okabe and Ito (2008), dark ones first, and two of Tol; repeated from the ninth flight on
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#44AA99")
# pairs of flights: others of Tol's, so that a colour means one thing
PAIR_COLORS = ("#332288", "#AA4499", "#117733", "#999933", "#661100", "#6699CC", "#DDCC77", "#888888")
