"""Laws from a logged flight: the estimates, their covariance, and the reasons to doubt or refuse them."""
