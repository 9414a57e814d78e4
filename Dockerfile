# docker build -t compplan . && docker run --rm -v "$PWD:/work" compplan plan JOB.toml --out out
FROM python:3.12-slim
COPY . /source
RUN pip install --no-cache-dir /source && rm -rf /source
RUN useradd --create-home planner
USER planner
WORKDIR /work
ENTRYPOINT ["compplan"]
CMD ["--help"]
