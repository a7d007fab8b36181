# docker build -t twin . ; docker run --rm -v "$PWD/out:/cell/out" twin
# The default is the demo: the three postures of the paper, simulated into out/. Any command may follow the image's name.
FROM python:3.12-slim
COPY pyproject.toml README.md LICENSE /src/
COPY twin /src/twin
COPY mjcf /src/mjcf
COPY docs /src/docs
RUN pip install --no-cache-dir /src && cp -r /src/mjcf/postures /postures && rm -r /src
WORKDIR /cell
ENTRYPOINT []
CMD ["sh", "-c", "for posture in milling upright rigid; do twin simulate /postures/$posture.yaml --out out/$posture; done"]
