"""Files in and out: observations as CRD, MINI or plain tables; residuals and solutions."""
