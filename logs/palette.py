"""Colours for several flights in one picture: a member has the same colour in report and viewer."""

# Okabe and Ito (2008), dark ones first, then two of Tol; the ninth flight has the first colour again
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#44AA99")
# other colours of Tol for pairs of flights, so that each colour has one meaning
PAIR_COLORS = ("#332288", "#AA4499", "#117733", "#999933", "#661100", "#6699CC", "#DDCC77", "#888888")
